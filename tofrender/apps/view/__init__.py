"""The explorer as a live application: files of any size, and renders that refine while one looks.

| module | holds |
|---|---|
| `looking` | what is looked at: a file, or a render under way |
| `window` | the page |
"""
