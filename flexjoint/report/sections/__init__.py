"""The sections of the page: each turns the material into one frozen value for its template."""
