"""The artwork style: a clean flat picture becomes few clean opaque shapes."""
