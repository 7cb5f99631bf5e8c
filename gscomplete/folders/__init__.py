"""Reading what folders say: object folders (a part and what is known of it) and run folders."""

from gscomplete.folders.drawable import Drawable, drawable_of, splat_files_of
from gscomplete.folders.object_folder import (
    COMPLETE_FILE,
    OBJECT_FILE,
    PARTIAL_FILE,
    ObjectFolder,
    object_folder_of,
    read_object_folder,
)
from gscomplete.folders.run_folder import (
    OUTPUT_FILE,
    RUN_FILE,
    RunFolder,
    alternative_file,
    read_run_folder,
)

__all__ = [
    "COMPLETE_FILE",
    "OBJECT_FILE",
    "OUTPUT_FILE",
    "PARTIAL_FILE",
    "RUN_FILE",
    "Drawable",
    "ObjectFolder",
    "RunFolder",
    "alternative_file",
    "drawable_of",
    "object_folder_of",
    "read_object_folder",
    "read_run_folder",
    "splat_files_of",
]
