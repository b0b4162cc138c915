"""Other methods, an adapter each; what they need is imported when they are loaded."""
