"""Motion to record: poses, patterns and transfers within limits, and the accuracy to expect."""
