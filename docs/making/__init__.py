"""Makes what the site shows and git does not keep.

`extension` is what Sphinx calls. `gallery` runs every shipped model and writes its page; `formats`
writes the reference of the documents, out of their JSON Schemas, `verbs` that of the command line,
out of its parser, both as `texts`. `following` does what a page says; `tutorial` keeps the pictures
that the tutorial makes. `links` finds links of the built site that lead nowhere.
"""
