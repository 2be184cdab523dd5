"""The backend ``local``: a bubblewrap sandbox over a folder on disk, for machines without a container engine."""
