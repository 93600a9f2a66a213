"""From picture files to result files: what to make from which input, what is there already, and who makes it."""
