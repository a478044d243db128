"""Two clouds in, one motion out: knows no track, no clock, no KITTI."""
