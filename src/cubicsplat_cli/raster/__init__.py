"""Drawing scenes: one differentiable operator over the engines."""
