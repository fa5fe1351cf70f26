"""Invalid texts, paths and settings files."""

TEXTS = (
    *("", " ", "-", "--", "x", "nan", "-inf", "1e400", "-1e39", "1e39", "9" * 5000, "-1", "0x10"),
    *("1,5", "1 2", "٣", "1٣", "３", "½", "²", "∞", "一"),
    *("\u202e3", "3\u200b", "\ud800", "\udcff3"),
    *("3\0", "\x1b[31m", "line\nline", "\r\n", "🚚" * 50, "w" * 100_000, "[" * 100_000),
    *('{"a":' * 50_000, "[[1]]", "null", "true", "%s%n%d", "$(reboot)", "__import__('os')"),
)
"""Texts that no numeric option accepts."""

PATHS = (
    *("", "\n", "new\nline", "a\0b", "a\tb", "\ud800", "\udcff", "\u202erun", "\x1b[2J", "~"),
    *("~/run", "~root", "x" * 256, "€" * 100, "a/" + "x" * 300 + "/b", "a/" * 3000, "a/" * 600),
    *("file", "file/", "file/run", "file/..", "/proc/run", "/proc/self/fd/run", "/sys/run"),
    *("/dev/null", "/dev/null/run", "/dev/full", "loop", "loop/run", "dangling", "dangling/run"),
    *("used", "used/", "used/../used", ".", "..", "/"),
)
"""Invalid run directories: `file` is a file, `used` holds one, `loop` and `dangling` are links."""

FILES = {
    "a.json": [
        *("", "{", "[]", "3", "nul", "null", '"x"', "{'seed': 1}", '{"seed": 1,}', "[" * 60000),
        *('{"a":' * 12000, '{"seed": 1, "seed": 2}', '{"seed": NaN}', '{"gamma": Infinity}'),
        *('{"gamma": -Infinity}', '{"seed": 1e400}', '{"seed": ' + "9" * 5000 + "}"),
        *('{"config": 3}', '{"config": {"gamma": "x"}}', '{"": 1}', '{"speed": 1}'),
        *('{"overrides": {"cooldown_s": {"a": [1]}}}', '{"overrides": {"name": "x"}}'),
        *('{"overrides": [1]}', '{"overrides": {"cooldown_s": 1, "cooldown_s": 2}}'),
        *('{"hidden": "12"}', '{"hidden": [[1]]}', '{"gamma": true}', '{"anneal": 1}'),
        *('{"scenario": ["paper"]}', '{"seed": "\\ud800"}', "\x00", "\ufeff{}", " " * 70000),
        '{"seed":' + " " * 70001 + "1}",
    ],
    "a.yaml": [
        *("", "- 1", "3", "a: [", "a: b: c", "\t- x", "seed: [", "seed: 1\nseed: 2"),
        *("{seed: 1, seed: 2}", "? [seed]\n: 1", "seed: !!python/object/apply:os.system [reboot]"),
        *("seed: !!python/name:os.system", "seed: !!bool x", "seed: !!timestamp x"),
        *("seed: !!int x", "seed: !!binary x", "seed: 2020-13-45", "seed: 2020-01-01"),
        *("seed: .nan", "gamma: .inf", "seed: 0x", "seed: 09", "seed: 1e3", "1: 2", "null: 1"),
        *("true: 1", "seed:", "seed: " + "9" * 5000, "[" * 60000, "- " * 30000, "{a: " * 15000),
        *("a: &a [x]\nseed: *a", "&a seed: *a"),
        "a: &a [x,x]\nb: &b [*a,*a,*a]\nc: &c [*b,*b,*b]\nhidden: *c",
        *("a: &a {seed: 1}\n<<: *a", "seed: |\n  1", "hidden: {1: 2}", "hidden: [[1]]"),
        *("overrides: 3", "overrides: {name: x}", "overrides: {3: 1}", "\x00", "%YAML 9.9"),
        *("--- 1\n--- 2", "%TAG ! x", "\x07", "x" * 70000, "*x", "seed: '", 'seed: "\\ud8"'),
    ],
}
"""Contents that are no settings, by file name."""
