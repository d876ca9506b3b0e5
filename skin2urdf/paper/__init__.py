"""The paper's own method and exploration, line by line, for comparison."""
