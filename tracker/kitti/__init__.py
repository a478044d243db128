"""The only place that knows the files, axes and quirks of KITTI."""
