"""A run as one HTML file that needs nothing else: its motion, curves, chart and events.

`page` collects the data of a run in one object and writes it into the file with `page.html`,
`page.css`, `scene.js` and `page.js`.
"""
