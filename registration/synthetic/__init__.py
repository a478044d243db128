"""Clouds with exact truth: meshes and the LiDAR that looks at them."""
