"""MVDream (sd-v2.1-base-4view): the multi-view prior of the paper, on diffusers' SD 2.1 blocks."""
