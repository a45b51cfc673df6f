"""The explorer of transients, in notebooks, as one page, and in `tofrender view`.

`data.py` reads a Dataset, and `contents.py` converts it to a header and bytes. `mount` of
`explorer.js` shows both in a page. `module.py` joins JavaScript and style.
"""
