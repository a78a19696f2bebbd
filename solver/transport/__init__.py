"""What diffuses in a body: morphogens."""
