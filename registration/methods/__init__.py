"""One file, one method, one cited paper."""
