"""What an algorithm sees: gray image in, numbers out."""
