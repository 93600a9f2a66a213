"""Drawing scenes: one differentiable operator over the engines; and the functions of the native library for drawings,
all of which raise EngineError if the library or the memory is missing.
"""
