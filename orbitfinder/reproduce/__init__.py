"""The MATLAB report, reproduced: one module per group of its figures, one page beside them."""
