"""List the benchmarks, each with what it measures; `stale` lists published results to renew."""

import ast
import sys
from pathlib import Path

from benchmarks import stale

FOLDER = Path(__file__).parent


def list_benchmarks() -> dict[str, str]:
    """List the modules that `python -m` runs, with the first lines of their docstrings."""
    found = {}
    for path in sorted(FOLDER.rglob("*.py")):
        text = path.read_text("utf-8")
        if '__name__ == "__main__"' in text and path.parent != FOLDER:
            folder = path.parent if path.name == "__main__.py" else path.with_suffix("")
            name = ".".join(("benchmarks", *folder.relative_to(FOLDER).parts))
            source = path.parent / "benchmark.py" if path.name == "__main__.py" else path
            source = source if source.exists() else path
            found[name] = (ast.get_docstring(ast.parse(source.read_text("utf-8"))) or "").split(
                "\n"
            )[0]
    return found


def main() -> None:
    """Print the list, or what is stale."""
    if sys.argv[1:] == ["stale"]:
        stale.main()
    for name, text in list_benchmarks().items():
        print(f"python -m {name}\n    {text}")


if __name__ == "__main__":
    main()
