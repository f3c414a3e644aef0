"""What tests share: robots, cases, readings of a command, pictures of a browser, marks."""
