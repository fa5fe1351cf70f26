"""Bad input as every benchmark's command line must take it."""

import pytest


def refused(main, argv, capsys):
    """The one line on stderr with which `main` ends, exit code 2, nothing on stdout."""
    with pytest.raises(SystemExit) as ended:
        main(argv)
    assert ended.value.code == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.count("\n") == 1
    return err
