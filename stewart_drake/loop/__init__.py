"""What a loop is made of: parts, and what runs them."""
