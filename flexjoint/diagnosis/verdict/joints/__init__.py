"""Each joint of which a set leaves much, looked at by itself: its ordinary friction, then all its causes."""
