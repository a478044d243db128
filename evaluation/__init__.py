"""Numbers against the truth: pure functions of arrays, and the tables and plots made of them."""
