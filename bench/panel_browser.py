"""Headless browser with the panel open, for the benchmark: a separate process without rendering."""

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager

# Everything except rendering, which needs a graphics card.
SCRIPT = """
import sys, time
from playwright.sync_api import sync_playwright
spare = '''
for (const name of ['drawElements', 'drawArrays', 'drawElementsInstanced', 'drawArraysInstanced'])
  WebGL2RenderingContext.prototype[name] = () => {};
'''
with sync_playwright() as playwright:
    flags = ['--no-sandbox', '--use-gl=angle', '--use-angle=swiftshader',
             '--enable-unsafe-swiftshader',
             '--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1']
    browser = playwright.chromium.launch(executable_path='/usr/bin/chromium', args=flags)
    page = browser.new_page()
    page.add_init_script(spare)
    page.goto(sys.argv[1])
    page.get_by_text('Replies to requests appear here.').wait_for(timeout=120000)
    print('looks', flush=True)
    sys.stdin.readline()
    browser.close()
"""
ENDS_WITHIN_S = 20.0


@contextmanager
def one_browser(address: str) -> Iterator[None]:
    """Keep an address open in a headless Chromium until the end of the block."""
    process = subprocess.Popen(
        ["nice", "-n", "19", sys.executable, "-c", SCRIPT, address],  # noqa: S607 - of every system
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    try:
        if process.stdout is None or process.stdout.readline().strip() != "looks":
            raise RuntimeError("the browser did not reach the page")
        yield
    finally:
        process.communicate("enough\n", timeout=ENDS_WITHIN_S)
