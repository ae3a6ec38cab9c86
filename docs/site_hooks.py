"""What the site is made of beside the pages in this folder: notebooks, and files of the repository that pages link to.

mkdocs calls these functions. A notebook becomes a page; a linked file beside ``docs`` becomes a page if it is Markdown
or a folder, else a file to download. Links are rewritten to where things are in the site.
"""

import json
import os
import re
from pathlib import Path, PurePosixPath
from typing import Any

from mkdocs.structure.files import File, Files

DOCS = Path(__file__).parent
ROOT = DOCS.parent
BESIDE = "repository"
"""Folder of the site for what does not lie in ``docs``."""
LINK = re.compile(r"(\]\()([^)\s#]+)((?:#[^)\s]*)?\))")
FENCE = re.compile(r"^```.*?^```$|`[^`\n]+`", flags=re.DOTALL | re.MULTILINE)
FILE_LANGUAGES = {".py": "python", ".toml": "toml", ".md": "markdown"}


def on_files(files: Files, config: Any) -> Files:
    """Add notebooks as pages, and what pages link to outside ``docs``."""
    for file in list(files):
        if file.src_uri.endswith(".ipynb"):
            page = notebook_page(Path(file.abs_src_path or ""))
            files.append(File.generated(config, file.src_uri.replace(".ipynb", ".md"), content=page))
    found = [*DOCS.rglob("*.md")]
    seen: set[Path] = set()
    while found:
        source = found.pop()
        for target in linked(source):
            if target.is_relative_to(DOCS) or target in seen or not target.is_relative_to(ROOT):
                continue
            seen.add(target)
            if target.suffix == ".md":
                found.append(target)
            files.append(beside(target, config))
    return files


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Rewrite links to what lies elsewhere in the site."""
    here = PurePosixPath(page.file.src_uri)
    source = source_of(here)
    return LINK.sub(lambda link: f"{link[1]}{rewritten(link[2], source, here)}{link[3]}", markdown)


def on_config(config: Any) -> Any:
    """Notebooks stand in the navigation by their own names."""
    config.nav = json.loads(json.dumps(config.nav).replace(".ipynb", ".md"))
    return config


def linked(source: Path) -> list[Path]:
    """Files of the repository that a document links to."""
    text = FENCE.sub("", source.read_text(encoding="utf-8"))
    targets = [(source.parent / link[2]).resolve() for link in LINK.finditer(text) if ":" not in link[2]]
    return [target for target in targets if target.exists()]


def source_of(page: PurePosixPath) -> Path:
    """The file in the repository that a page of the site is made from."""
    if page.parts[0] != BESIDE:
        return DOCS / page
    made_from = ROOT.joinpath(*page.parts[1:])
    return made_from if made_from.exists() else made_from.with_suffix("")


def rewritten(link: str, source: Path, here: PurePosixPath) -> str:
    """A relative link of a document, as it is in the site."""
    if ":" in link:  # an address, or a picture in place
        return link
    target = (source.parent / link).resolve()
    if not target.exists() or not target.is_relative_to(ROOT):
        return link
    place = str(place_of(target))
    return os.path.relpath(place, str(here.parent)).replace(os.sep, "/")


def place_of(target: Path) -> PurePosixPath:
    """Where a file of the repository is in the site."""
    if target.is_relative_to(DOCS):
        place = PurePosixPath(target.relative_to(DOCS).as_posix())
        return place.with_suffix(".md") if place.suffix == ".ipynb" else place
    place = PurePosixPath(BESIDE, target.relative_to(ROOT).as_posix())
    return place.with_name(f"{place.name}.md") if target.is_dir() else place


def beside(target: Path, config: Any) -> File:
    """A file or folder that lies outside ``docs``."""
    place = str(place_of(target))
    if target.is_dir():
        return File.generated(config, place, content=folder_page(target))
    return File.generated(config, place, abs_src_path=str(target))


def folder_page(folder: Path) -> str:
    """Its files, one after another."""
    parts = [f"# {folder.relative_to(ROOT).as_posix()}\n"]
    for path in sorted(folder.rglob("*")):
        if path.suffix in FILE_LANGUAGES:
            name, language = path.relative_to(folder).as_posix(), FILE_LANGUAGES[path.suffix]
            parts.append(f"## {name}\n\n````{language}\n{path.read_text(encoding='utf-8')}````\n")
    return "\n".join(parts)


def notebook_page(path: Path) -> str:
    """Its cells with what they printed and drew when it was last run (``run_notebooks.py``)."""
    parts = [f'<a href="{path.name}" download>This page as a notebook</a>\n']
    for cell in json.loads(path.read_text(encoding="utf-8"))["cells"]:
        text = "".join(cell["source"])
        if cell["cell_type"] == "markdown":
            parts.append(text)
            continue
        parts.append(f"```python\n{text}\n```")
        for output in cell["outputs"]:
            data = output.get("data", {})
            if "image/png" in data:
                parts.append(f"![What the cell draws](data:image/png;base64,{data['image/png'].strip()})")
            elif words := "".join(output.get("text", data.get("text/plain", ""))):
                parts.append(f"```text\n{words.rstrip()}\n```")
    # Its title comes first.
    parts[0], parts[1] = parts[1], parts[0]
    return "\n\n".join(parts) + "\n"
