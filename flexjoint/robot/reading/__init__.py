"""Robot files and descriptions as they are read: bounded, and checked before a parser sees them."""
