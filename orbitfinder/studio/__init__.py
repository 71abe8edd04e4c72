"""The studio: a page of this computer on which a mechanism is dragged to an orbit, and the orbit to its families."""
