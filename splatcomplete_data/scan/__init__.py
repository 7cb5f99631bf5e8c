"""Scans: readers of point clouds, and their cleaning."""

from splatcomplete_data.scan.cloud import GREY, PointCloud
from splatcomplete_data.scan.pcd import lzf_decompress, read_pcd

__all__ = ["GREY", "PointCloud", "lzf_decompress", "read_pcd"]
