"""Soft shadows and glows: blurred silhouettes over even grounds, taken off the picture and drawn as gradients."""
