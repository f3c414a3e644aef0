"""The extended model in other simulators: one file a target, and what each of them can express."""
