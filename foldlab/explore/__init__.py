"""The explorer: a page on this machine where designs are set by hand, judged at once, and solved.

Served by Python's own http.server and drawn by plotly.js from pip's ``plotly``: a slider's answer
takes the model's 30 ms and no framework's round trip, shapes turn in 3-D by WebGL, nothing is
fetched from the internet, and no server that would have to be kept up to date is installed.
"""
