"""Two pictures under a divider that one drags: techniques of the course, or files.

| module | holds |
|---|---|
| `pictures` | the course's scenes by each technique, references, and files |
| `window`, `divider.js` | the page |
"""
