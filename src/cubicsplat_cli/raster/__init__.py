"""Drawing scenes, one differentiable operator over the engines; and what drawings leave to the native library. All
functions that call the library raise EngineError if it, or the memory, is missing.
"""
