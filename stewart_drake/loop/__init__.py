"""Parts of a loop, and what runs them."""
