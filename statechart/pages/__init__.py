"""A run as one HTML file that needs nothing else: its motion, curves, chart and events.

`page` makes of a run what the page shows, as one object, and puts it with `page.html`, `page.css`,
`scene.js` and `page.js` into the file.
"""
