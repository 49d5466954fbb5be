"""What a control does to a system."""
