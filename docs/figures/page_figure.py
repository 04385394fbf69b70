#!/usr/bin/env python3
"""Renders one figure of a page of cpcm, or an SVG file, as PNG: page_figure.py PAGE.html|FILE.svg OUT.png [INDEX]. Needs chromium."""
import re
import subprocess
import sys
import tempfile
from pathlib import Path

source, out, index = Path(sys.argv[1]), sys.argv[2], int(sys.argv[3]) if len(sys.argv) > 3 else 0
svg = re.findall(r"<svg.*?</svg>", source.read_text(), re.S)[index]
width, height = (int(v) // 2 for v in re.search(r'viewBox="0 0 (\d+) (\d+)"', svg).groups())
with tempfile.TemporaryDirectory() as work:
    page = Path(work) / "figure.html"
    page.write_text(f'<body style="margin:0;background:#fff"><div style="width:{width}px">{svg}</div></body>')
    subprocess.run(
        ["chromium", "--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars",
         f"--window-size={width},{height}", f"--screenshot={out}", f"file://{page}"],
        check=True, stderr=subprocess.DEVNULL,
    )
