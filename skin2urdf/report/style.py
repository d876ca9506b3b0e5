"""Colours and sizes that the pictures share; the colours can be told apart by the colour-blind."""

INK = "#1f2933"
"""Text and outlines."""
FAINT = "#7b8794"
"""Secondary text."""
GRID = "#e4e7eb"
"""Lines between cells."""
FILL = "#3e5c76"
"""An entry of the activity matrix that is 1."""
ACCENT = "#e69f00"
"""What a picture is about."""
LEAF = "#009e73"
"""True end effectors."""
INNER = "#b3589a"
"""False end effectors."""
WARNING = "#c0392b"
"""Violated constraints."""
PAPER = "#f5f7fa"
"""Background of boxes."""

SMALL = 6.5
"""Labels [pt]."""
NORMAL = 8.0
"""Running text [pt]."""
HEADING = 10.0
"""Titles of panels [pt]."""
TITLE = 14.0
"""Title of a figure [pt]."""
