"""A page with a command and places for its output, and what it prints."""

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
