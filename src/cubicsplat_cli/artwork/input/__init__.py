"""Degradations between a drawing and its picture: noise, JPEG, blur and enlargement are found and undone."""
