"""What a scene amounts to before it is rendered."""
