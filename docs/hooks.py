"""Build steps of the site: equations as MathML (no script, no network), and pages that are made from the repository.

`$...$` and `$$...$$` outside code become MathML. A line `<!-- include NAME -->` is replaced by that file of the
repository's root; links in it that leave docs/ are shown as plain file names. `<!-- commands -->` becomes the table of
every command's arguments, from the parser itself, `<!-- settings -->` the tables of all settings.
"""

import argparse
import re
import runpy
import sys
import tempfile
from html import escape
from pathlib import Path

from latex2mathml.converter import convert
from mkdocs.structure.files import File

ROOT = Path(__file__).resolve().parents[1]
NOTEBOOK = re.compile(r"(?<!\[The notebook)\]\(([\w./]+)\.ipynb\)")
CODE = re.compile(r"(^```.*?^```[ \t]*$|`[^`\n]+`)", re.DOTALL | re.MULTILINE)
DISPLAYED = re.compile(r"\$\$(.+?)\$\$", re.DOTALL)
INLINE = re.compile(r"(?<![\\$\w])\$(?=\S)([^$\n]+?)(?<=\S)\$(?![\w$])")
INCLUDE = re.compile(r"^<!-- include (\S+) -->$", re.MULTILINE)
COMMANDS = "<!-- commands -->"
SETTINGS = "<!-- settings -->"
LINK = re.compile(r"(?<!!)\[([^\]]+)\]\((?!#)([^)]+)\)")


def _display(found: re.Match) -> str:
    # with the source beside it: a screen reader and a copy need it
    source = " ".join(found[1].split())
    formula = convert(source, display="block").replace("<math ", f'<math alttext="{escape(source, quote=True)}" ', 1)
    return f'\n\n<div class="equation">{formula}</div>\n\n'


def _included(found: re.Match) -> str:
    text = (ROOT / found[1]).read_text(encoding="utf-8")
    text = re.sub(r"\A# .*\n", "", text)
    return LINK.sub(lambda link: f"{link[1]} (`{link[2]}`)", text)


def _cell(text: str) -> str:
    return re.sub(r"([|<>*_\[\]])", r"\\\1", text)


def commands_page() -> str:
    """A section a command: what it does, a row an argument, an example."""
    sys.path.insert(0, str(ROOT))
    from probupdate.cli import EXAMPLES, build_parser

    (verbs,) = (action for action in build_parser()._actions if action.dest == "verb")
    lines = []
    for name, parser in verbs.choices.items():
        lines += [f"## {name}", "", _cell(parser.description), "", "| argument | meaning |", "|---|---|"]
        for action in parser._actions:
            if action.dest == "help" or action.help == argparse.SUPPRESS:
                continue
            value = "" if action.nargs == 0 else f" {action.metavar or action.dest.upper()}"
            if action.choices:
                value = " " + ", ".join(map(str, action.choices))
            shown = f"{action.option_strings[-1]}{value}" if action.option_strings else value.strip()
            needed = " (required)" if action.required and action.option_strings else ""
            lines.append(f"| `{shown}` | {_cell(action.help or '')}{needed} |")
        lines += ["", "```sh", f"probupdate {EXAMPLES[name]}", "```", ""]
    return "\n".join(lines)


def on_files(files, config):
    """The picture of the README, which belongs to its study; notebooks, run, as pages."""
    picture = ROOT / "studies" / "discovery" / "demonstration.png"
    files.append(File.generated(config, "pictures/demonstration.png", abs_src_path=str(picture)))
    sys.path[:0] = [str(ROOT), str(ROOT / "docs")]
    import notebooks

    for path in sorted((ROOT / "docs" / "tutorials").glob("*.ipynb")):
        with tempfile.TemporaryDirectory() as folder:
            text, figures = notebooks.page(path, Path(folder))
        files.append(File.generated(config, f"tutorials/{path.stem}.md", content=text))
        for name, content in figures.items():
            files.append(File.generated(config, f"tutorials/{name}", content=content))
    return files


def on_page_markdown(markdown: str, **_) -> str:
    markdown = INCLUDE.sub(_included, markdown)
    if COMMANDS in markdown:
        markdown = markdown.replace(COMMANDS, commands_page())
    if SETTINGS in markdown:
        sys.path.insert(0, str(ROOT))
        markdown = markdown.replace(SETTINGS, runpy.run_path(str(ROOT / "docs" / "settings_page.py"))["page"]())
    markdown = markdown.replace("](../studies/discovery/demonstration.png)", "](pictures/demonstration.png)")
    markdown = NOTEBOOK.sub(r"](\1.md)", markdown)
    # pages of studies are read in the repository
    markdown = re.sub(r"\[([^\]]+)\]\(\.\./studies/([^)]+)\)", r"\1 (`studies/\2`)", markdown)
    parts = CODE.split(markdown)
    for i in range(0, len(parts), 2):
        parts[i] = DISPLAYED.sub(_display, parts[i])
        parts[i] = INLINE.sub(lambda found: convert(found[1]), parts[i])
    return "".join(parts)
