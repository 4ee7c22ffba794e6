"""The example of the README runs."""

import pathlib
import re

README = pathlib.Path(__file__).parent.parent / "README.md"


def test_the_example_runs(capsys):
    example = re.search(r"^```python\n(.*?)^```", README.read_text(), re.M | re.S).group(1)
    exec(example, {})
    said = capsys.readouterr().out.splitlines()
    assert re.match(r"\d+/64 cells, \w+", said[0])
    pvs = "<sightline.Pvs: 64 cells over 300 triangles, method aggressive>"
    shown, error = re.match(re.escape(pvs) + r" (\d+) (\S+)$", said[-1]).groups()
    assert 0 < int(shown) < 300 and 0 <= float(error) < 0.01
