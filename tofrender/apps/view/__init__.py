"""The explorer as a live application, for files of any size and for renders in progress."""
