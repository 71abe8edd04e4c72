"""Rigorous existence proofs: validated Taylor integration and an interval Newton theorem in ball arithmetic."""
