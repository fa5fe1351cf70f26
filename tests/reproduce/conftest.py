"""A page with blocks, and a book of them that nothing is run for."""

import pytest

from docs.reproduce import run
from docs.reproduce.pages import Block

PAGE = """Before.

<!-- run count, 2 min -->
```
python -m benchmarks.calibrate \\
    --episodes 3
```

Of what it prints:

<!-- from count -->
```
old
```

<!-- from count: /^[ab]/ -->
```
old
```

<!-- from count: /^| n/,/^$/ -->
| old |
|---|

<!-- from count: counted.png -->
![A picture](images/a.png)

<!-- from other -->
```
stays
```
"""
PRINTED = "\na 1\nb 2  \nc 3\n\n| n | x |\n|---|---|\n| 1 | 2 |\n\nend\n"


@pytest.fixture
def book(tmp_path, monkeypatch):
    """Two blocks of a page, the second of which plays what the first trains; what is run is told, not run."""
    page = tmp_path / "page.md"
    page.write_text(PAGE)
    (tmp_path / "images").mkdir()
    monkeypatch.setattr(run, "ROOT", tmp_path)
    monkeypatch.setattr(run, "STAMPS", tmp_path / "reproduced.json")
    monkeypatch.setattr(run, "WORK", tmp_path)
    (tmp_path / "counted.png").write_bytes(b"drawn")
    learn = Block("learn", page, 600, (("train.ppo", "--run-dir", "runs/a"),))
    play = Block("count", page, 60, (("train.evaluate", "--run-dir", "runs/a"),))
    return run.Book({"count": play, "learn": learn})
