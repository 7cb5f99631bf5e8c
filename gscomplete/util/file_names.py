"""Names of the files that make object, run and dataset folders."""

OBJECT_FILE = "object.json"
PARTIAL_FILE = "partial.ply"
COMPLETE_FILE = "complete.ply"
RUN_FILE = "run.json"
OUTPUT_FILE = "completed.ply"
DATASET_FILE = "dataset.json"
ALTERNATIVES_FOLDER = "alternatives"
