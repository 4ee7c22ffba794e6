#!/usr/bin/env python3
"""Prepares and checks the documentation site; scripts/book.sh calls it.

    scripts/book.py stage FOLDER PROGRAM   copy the pages to FOLDER and generate the reference of PROGRAM
    scripts/book.py check FOLDER           check the links of the built site in FOLDER

The staged pages keep the layout of the repository, so most links stay unchanged. If a page links to a file
that is not a page, the script copies the file. If a page links to a folder, the script replaces the link with
its text. A page that docs/SUMMARY.md does not list is an error, and so is a link to such a page.
"""

import html.parser
import os
import re
import shutil
import subprocess
import sys
import urllib.parse

ROOT = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))
COMMANDS = "docs/commands.md"
COMMANDS_MARK = "<!-- The generated page of all commands is inserted here. -->"
LINK = re.compile(r"\[([^][]*)\]\(([^()\s]*)\)")


def read(*path):
    """Returns the text of a file."""
    with open(os.path.join(*path), encoding="utf-8") as file:
        return file.read()


def write(text, *path):
    """Writes a file and creates its folder."""
    os.makedirs(os.path.dirname(os.path.join(*path)), exist_ok=True)
    with open(os.path.join(*path), "w", encoding="utf-8") as file:
        file.write(text)


def aim_of(page, target):
    """Returns the target of a relative link of a page as a path from the root, or None for other links."""
    if re.match(r"[a-zA-Z][\w+.-]*:|#|$", target):
        return None
    name = urllib.parse.unquote(target.partition("#")[0])
    return os.path.normpath(os.path.join(os.path.dirname(page), name))


def stage(folder, program):
    """Copies the listed pages and the files that they link to, and returns a list of faults."""
    source, faults = os.path.join(folder, "src"), []
    shutil.rmtree(folder, ignore_errors=True)
    summary = read(ROOT, "docs/SUMMARY.md")
    pages = [aim_of("docs/SUMMARY.md", target) for _, target in LINK.findall(summary) if target]
    for path in sorted(set(markdown_files()) - set(pages) - {"docs/SUMMARY.md"}):
        faults.append(f"{path}: add the page to docs/SUMMARY.md")
    if COMMANDS_MARK not in summary:
        faults.append(f"docs/SUMMARY.md: the line {COMMANDS_MARK} is missing")

    # SUMMARY.md moves from docs/ to the root of the staged pages.
    summary = summary.replace(COMMANDS_MARK, "- [Commands](commands.md)")
    summary = LINK.sub(lambda m: f"[{m[1]}]({aim_of('docs/SUMMARY.md', m[2]) or m[2]})", summary)
    write(summary, source, "SUMMARY.md")
    write(reference(program), source, COMMANDS)
    shutil.copy(os.path.join(ROOT, "docs/book.toml"), folder)
    for page in pages:
        if os.path.isfile(os.path.join(ROOT, page)):
            write(staged(page, pages, source, faults), source, page)
        else:
            faults.append(f"docs/SUMMARY.md: {page} does not exist")
    return faults


def markdown_files():
    """Yields the Markdown files of docs/."""
    for here, _, names in os.walk(os.path.join(ROOT, "docs")):
        for name in names:
            if name.endswith(".md"):
                yield os.path.relpath(os.path.join(here, name), ROOT)


def staged(page, pages, source, faults):
    """Returns the text of a page with the links of the site, and copies the files that it links to."""

    def link(match):
        """Returns the replacement of a link."""
        aim = aim_of(page, match[2])
        if aim is None or aim in pages:
            return match[0]
        path = os.path.join(ROOT, aim)
        if aim.startswith("..") or not os.path.exists(path):
            faults.append(f"{page}: {match[2]} does not exist")
        elif os.path.isdir(path):
            return match[1]
        elif aim.endswith(".md"):
            faults.append(f"{page}: add the page {match[2]} to docs/SUMMARY.md")
        else:
            os.makedirs(os.path.dirname(os.path.join(source, aim)), exist_ok=True)
            shutil.copy(path, os.path.join(source, aim))
        return match[0]

    parts = re.split(r"(^```.*?^```)", read(ROOT, page), flags=re.DOTALL | re.MULTILINE)
    return "".join(part if n % 2 else LINK.sub(link, part) for n, part in enumerate(parts))


def help_of(program, *words):
    """Returns the help text of a command, without the values of environment variables."""
    done = subprocess.run([program, *words, "--help"], stdout=subprocess.PIPE, check=True, text=True, env={})
    return done.stdout.strip()


def reference(program):
    """Returns the page of all commands, in the groups and the order of the program's help."""
    overview = help_of(program)
    text = "# Commands\n\n`sightline --help` prints this overview, and `sightline COMMAND --help` each "
    text += f"section.\n\n```text\n{overview}\n```\n"
    for line in overview.split("\n"):
        group = re.fullmatch(r"(\w[\w ]*):", line)
        command = re.match(r"  ([a-z][\w-]*)  +\S", line)
        if group and group[1] != "Options":
            text += f"\n## {group[1]}\n"
        elif command and command[1] != "help":
            text += section(program, [command[1]])
    return text


def section(program, words):
    """Returns the section of a command and the sections of its subcommands."""
    printed = help_of(program, *words)
    text = f"\n### sightline {' '.join(words)}\n\n```text\n{printed}\n```\n"
    block = re.search(r"^Commands:\n((?:  .*\n|\n)+)", printed, re.MULTILINE)
    for name in re.findall(r"^  ([a-z][\w-]*)(?:  |$)", block[1] if block else "", re.MULTILINE):
        text += section(program, [*words, name]) if name != "help" else ""
    return text


class Page(html.parser.HTMLParser):
    """The links and anchors of a built page."""

    def __init__(self, text):
        super().__init__()
        self.links, self.anchors = [], set()
        self.feed(text)

    def handle_starttag(self, _, attributes):
        """Records the targets and the ids of an element."""
        for name, value in attributes:
            if name in ("href", "src") and value:
                self.links.append(value)
            elif name in ("id", "name"):
                self.anchors.add(value)


def check(folder):
    """Returns the dead links of a built site."""
    pages, faults = {}, []
    for here, _, names in os.walk(folder):
        for name in names:
            if name.endswith(".html"):
                path = os.path.relpath(os.path.join(here, name), folder)
                pages[path] = Page(read(folder, path))
    for path, page in sorted(pages.items()):
        for target in page.links:
            url = urllib.parse.urlsplit(target)
            if url.scheme or url.netloc:
                continue
            aim = os.path.normpath(os.path.join(os.path.dirname(path), urllib.parse.unquote(url.path)))
            aim = path if not url.path else aim
            anchor = urllib.parse.unquote(url.fragment)
            if not os.path.isfile(os.path.join(folder, aim)):
                faults.append(f"{path}: {target} does not exist")
            elif anchor and aim in pages and anchor not in pages[aim].anchors:
                faults.append(f"{path}: {target}: the page has no such heading")
    print(f"book: {len(pages)} pages, {sum(len(p.links) for p in pages.values())} links")
    return faults


def main():
    """Runs the command and returns the exit code."""
    if len(sys.argv) == 4 and sys.argv[1] == "stage":
        faults = stage(sys.argv[2], sys.argv[3])
    elif len(sys.argv) == 3 and sys.argv[1] == "check":
        faults = check(sys.argv[2])
    else:
        print(__doc__, file=sys.stderr)
        return 2
    for fault in faults:
        print(f"book: {fault}", file=sys.stderr)
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())
