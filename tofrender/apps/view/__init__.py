"""The explorer as a live application: files of any size, and renders that refine while shown."""
