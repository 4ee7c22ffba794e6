#!/usr/bin/env python3
"""Opens a web page, waits until the page has received its data, and stores a screenshot.

    scripts/screenshot.py URL OUT.png WIDTH HEIGHT SECONDS

WIDTH and HEIGHT are the size of the window in pixels. SECONDS is the time between the opening and the
screenshot. The script needs chromium and chromedriver (scripts/setup.sh --for test).
"""
import base64
import json
import subprocess
import sys
import time
import urllib.request


def main():
    url, out, width, height, seconds = sys.argv[1:]
    driver = subprocess.Popen(["chromedriver", "--port=0"], stdout=subprocess.PIPE, text=True)
    try:
        port = next(
            line.rsplit("successfully on port ", 1)[1].strip(" .\n") for line in driver.stdout
            if "successfully on port " in line)

        def call(path, body=None, method=None):
            data = None if body is None else json.dumps(body).encode()
            request = urllib.request.Request(
                f"http://127.0.0.1:{port}/session{path}", data, {"content-type": "application/json"},
                method=method)
            return json.load(urllib.request.urlopen(request, timeout=60))["value"]

        arguments = ["--headless=new", "--no-sandbox", "--use-angle=swiftshader",
                     "--enable-unsafe-swiftshader",
                     "--hide-scrollbars", f"--window-size={width},{height}"]
        wanted = {"capabilities": {"alwaysMatch": {"goog:chromeOptions": {"args": arguments}}}}
        session = "/" + call("", wanted)["sessionId"]
        try:
            call(f"{session}/url", {"url": url})
            time.sleep(float(seconds))
            with open(out, "wb") as picture:
                picture.write(base64.b64decode(call(f"{session}/screenshot")))
        finally:
            # The browser does not end with its driver, so end the browser first.
            call(session, method="DELETE")
    finally:
        driver.kill()
        driver.wait()


main()
