"""A static site that opens from disk: gallery, orbit, family and atlas pages made from result files."""
