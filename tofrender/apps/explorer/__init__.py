"""The explorer of transients, in notebooks, as one page, and in `tofrender view`.

`data.py` takes a Dataset, `contents.py` makes a header and bytes of it, and `mount` of
`explorer.js` shows them in a page. `module.py` joins JavaScript and style.
"""
