"""The explorer of transients, in notebooks, as one page, and in `tofrender view`.

`data.py` reads a Dataset, and `page_contents.py` converts it to a header and bytes. `mount` of
`explorer.js` shows both in a page. `module.py` joins JavaScript and style.

The figures of the explorer are drawn by `plot.js` instead of a library, because a report is one
HTML file that works without a network. A library would be part of each file. Bokeh, which Panel
brings, is the only such library among the dependencies, and is larger than the whole explorer.
"""
