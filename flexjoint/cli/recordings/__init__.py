"""Commands on recordings: make one of another log, and find what is wrong in one."""
