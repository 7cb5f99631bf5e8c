"""The guess of the complete object: voxels, symmetry, a 3D network, and the splats it implies."""
