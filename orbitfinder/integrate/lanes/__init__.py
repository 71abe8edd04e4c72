"""Marches of many segments at once in the registers of the processor."""
