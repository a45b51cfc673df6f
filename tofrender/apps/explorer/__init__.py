"""The explorer: light in time, in a notebook or as one page, drawn by one JavaScript module.

`contents.py` turns a Dataset into a header and bytes, `module.py` has JavaScript and style as text,
`widget.py` and `page.py` bring both together. In JavaScript, `mount(element, {header, bytes})` of
`explorer.js` shows them anywhere.
"""
