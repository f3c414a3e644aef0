"""Other runs than of one whole recording: many side by side, one that goes on live, a long one in pieces."""
