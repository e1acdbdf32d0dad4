"""Commands that explain what others say."""
