"""The page of a run: one HTML file that plays it, from a log and without a network.

| module | what it does |
|---|---|
| `pack` | whole numbers -> few bytes -> base64, as `data.js` unpacks them |
| `motion` | ten seconds of tracks, predictions and slots -> whole numbers |
| `lines` | the reference lines that vehicles were on, along which slots are drawn |
| `road` | the lanes near where somebody was |
| `head` | what is known of the whole run: vehicles, advice, events, scores, settings |
| `page` | the file |

The scripts and the style lie beside them in `assets/`.
"""
