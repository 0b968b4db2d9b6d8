"""What is stated with a number, measured by one command."""
