#!/usr/bin/env python3
"""Checks the prose of the tracked Rust and Markdown files against the style rules of CONTRIBUTING.md.

    scripts/prose.py                       check the whole repository
    scripts/prose.py README.md crates/pvs  check some files and folders
    scripts/prose.py --summary             print only the table of counts
    scripts/prose.py --self-test           check the rules on small examples

In Rust files, the script reads doc comments, comments, messages of thiserror and help texts of clap. Each
finding is one line: `path:line: rule: excerpt -> hint`. A table of counts and limits follows. The exit code is
1 if a rule exceeds its limit, 2 for wrong usage, and 0 otherwise. A limit in percent refers to the number of
texts that the rule applies to, such as sentences or doc comments.
"""

import argparse
import bisect
import collections
import os
import re
import subprocess
import sys
import urllib.parse

# Rule -> limit, whether the limit is a percentage, the counted texts, and the meaning.
RULES = {
    "headless": (1, True, "doc comments", "a doc comment opens with a clause such as Whether, What or How"),
    "opener": (0.5, True, "doc comments", "a doc comment opens with a pronoun, a preposition or a superlative"),
    "noun": (5, True, "function docs", "the doc comment of a function opens with a noun instead of a verb"),
    "clause": (1, True, "sentences", "a clause stands for a noun: what is ..., whatever ..., who ..."),
    "banned": (0.5, True, "sentences", "an idiom or a vague word; the hint has the plain words"),
    "long": (1, True, "sentences", "a sentence of more than 40 words"),
    "wide": (0, False, "Markdown lines", "a line of Markdown prose of more than 110 columns"),
    "link": (0, False, "links", "a relative link to a file or heading that does not exist"),
    "term": (0, False, "terms", "a glossary defines a term twice"),
    "module": (0, False, "Rust files", "the name of a file is a verb, an adverb or a question word"),
    "type": (0, False, "types", "the name of a type is a verb form, a preposition or a question word"),
    "test": (1, True, "tests", "a test name begins with an article, contains a clause, or is too long"),
}
MAX_WORDS, MAX_COLUMNS, MAX_TEST_NAME = 40, 110, 90

# First words of doc comments -> hint.
CLAUSE_OPENERS = dict.fromkeys(
    "what who whom whose which those whoever whatever whichever wherever however".split(), "name the thing or the actor")
CLAUSE_OPENERS.update(
    whether="Returns true if ...; for a field: True if ...", how="The number of ..., The strategy for ...",
    when="The time at which ...", where="The path of ..., The position of ...",
    why="The reason ..., An error that ...", that="Checks that ...")
# Openings with such a word that are complete sentences or common idioms.
COMPLETE_OPENING = re.compile(
    r"\w+ (?:or not )?to [a-z]|(?:when|where|whatever)\b[^.]*, |(?:when|where) (?:possible|enabled|set|given|present"
    r"|configured|true|false)\b|that is\b|however,|[^.]*\?", re.IGNORECASE)
# Openings that are good in the documentation of a value.
VALUE_OPENING = re.compile(r"(?:Whether|When|How (?:many|much|long|often|far|large|big|deep))\b")
VALUES = ("field", "variant", "const", "static")
WEAK_OPENERS = [
    (r"(?:Its|They|Them|Theirs?|Their|Others|Another one|One of them|The same|The other(?=[.,]| [a-z]+\.)"
     r"|(?:No|Some|Every|Any)body|(?:Some|Any|Every|No)thing"
     r"|It(?! (?:is|would be) (?:an error|possible|safe|undefined|recommended)\b))\b", "name the item"),
    (r"(?:Of|Among|Beside|Beyond|Until|Up to|By(?! default\b)|From(?! [\d.]+ ?\w+ to\b)"
     r"|As(?! (?:such|of|a result|long|soon|per)\b)(?![^.,]*,))\b", "add the noun or the verb"),
    (r"(?:Most|Least|Greatest|Fewest)\b(?! of the\b)", "Maximum ..., Minimum ..., Largest ..."),
]
NOUN_OPENER = re.compile(r"(?:The|An?|One|Two|Three|All|Both|Each|Every|Some|No|Number|Bytes)\b")

CLAUSE = re.compile(
    r"\bwhat\b(?!['’]|(?: \w+)? (?:to|if|happen(?:s|ed)?|kinds?|types?|sort|extent)\b)|\bwho(?:so)?ever\b|\bwhichever\b"
    r"|(?:^|[,;:(—–] ?|\b(?:to|for|of|by|from|with|and|or|asks|says) )who\b(?! (?:is|are) (?:using|running)\b)",
    re.IGNORECASE)
# A clause after such words is an indirect question, which has no shorter form.
ASKING = ("describ clarif document explain see know show specif determin decide deciding understand learn note defin "
          "control check is are be was validat match mirror mimick record about configur remember consider "
          "surprising exceed imagin exactly precisely").split()
ASKING = re.compile(
    r"\b(?:(?:%s)\w*|figure out|find out|(?:regardless|idea|sense|terms) of|(?:depend\w*|based) on|identical to|same as)"
    r"(?: (?:just|only|not))?[ *_]*$" % "|".join(w if len(w) > 3 else w + r"(?!\w)" for w in ASKING),
    re.IGNORECASE)


def read_words():
    """Returns the entries of prose_words.txt: a dictionary from a hint to the text behind the arrow."""
    text = read(os.path.join(os.path.dirname(os.path.abspath(__file__)), "prose_words.txt"))
    lines = [line for line in text.split("\n") if line and not line.startswith("#")]
    # A continued word list needs the space; a continued expression must not have one.
    joined = re.sub(r"\n  (?=\|)", "", "\n".join(lines)).replace("\n  ", " ")
    return dict(entry.split(" <- ") for entry in joined.split("\n"))


def read(path):
    """Returns the text of a file."""
    with open(path, encoding="utf-8", errors="replace") as file:
        return file.read()


WORDS = read_words()
MODULE_NAMES, TYPE_NAMES = set(WORDS.pop("MODULES").split()), set(WORDS.pop("TYPES").split())
BANNED_HINTS = list(WORDS)
BANNED = re.compile("|".join(rf"\b(?P<b{number}>{words.replace('END', '(?=[.,;:)]|$)')})"
                             for number, words in enumerate(WORDS.values())), re.IGNORECASE)
TEST_WORDS = re.compile(
    r"(?:an?|the)_|(?:.*_)?(?:what|who|whom|whoever|whatever|whichever|nobody|somebody|those|alone)(?:_|$)")


class Tally:
    """The findings of a run, and the number of texts that each limit refers to."""

    def __init__(self):
        self.findings, self.bases = [], collections.Counter()

    def add(self, path, line, rule, text, hint):
        """Adds a finding with an excerpt of at most 90 characters."""
        text = " ".join(text.split())
        self.findings.append((path, line, rule, text if len(text) <= 90 else text[:88] + "…", hint))


# Sentences


def without_markup(text):
    """Replaces code spans, links, addresses and tags; line ends stay, so that positions keep their line."""
    text = re.sub(r"(`+)(.+?)\1", lambda m: "‹code›" + "\n" * m.group().count("\n"), text, flags=re.DOTALL)
    text = re.sub(r"!?\[([^][]*)\](?:\([^()\s]*(?:\([^()\s]*\))?(?:\s+\"[^\"]*\")?\)|\[[^]]*\])", r"\1", text)
    text = re.sub(r"<?https?://[^\s>)\]]+>?", "‹url›", text)
    return re.sub(r"</?[a-zA-Z][^<>]*>", " ", text)


def paragraphs(lines):
    """Yields lists of (line number, text), one for each paragraph, list item and table cell outside code."""
    block, fence = [], None
    for number, text in lines + [(0, "")]:
        bare = text.strip()
        mark = re.match(r"```|~~~", bare)
        if mark and fence in (None, mark.group()):
            fence = None if fence else mark.group()
        is_table = bare.startswith("|") and bare.count("|") > 1
        ends = not bare or fence or mark or is_table or re.match(
            r"#{1,6} |[-=*_]{3,}$|\[[^]]+\]: |</?[a-z]+[^>]*>$|:::", bare)
        item = re.match(r"(?:[-*+]|\d+[.)])\s+", bare)
        if block and (ends or item):
            yield block
            block = []
        if is_table and not fence:
            for cell in re.split(r"(?<!\\)\|", bare.strip("|")):
                if re.search(r"[A-Za-z]{2}", cell):
                    yield [(number, cell.strip())]
        elif not ends and (block or item or not text.startswith("    ")):
            block.append((number, re.sub(r"^(?:[-*+>]|\d+[.)])\s+", "", bare)))


def sentences(block):
    """Yields (line number, text) for each sentence of a paragraph."""
    text, start = without_markup("\n".join(text for _, text in block)), 0
    for end in re.finditer(r"[.!?][\"'”)\]*_]*(?=\s)|\Z", text):
        piece = text[start:end.end()]
        is_ellipsis = piece.endswith("...") and re.match(r"\s[a-z]", text[end.end():end.end() + 2])
        if is_ellipsis or re.search(r"\b(?:e\.g|i\.e|cf|vs|etc|al|fig|sec|ch|approx|ca|Dr|Mr|St|resp|incl)\.$", piece,
                                re.IGNORECASE):
            continue
        if piece.strip():
            skipped = len(piece) - len(piece.lstrip())
            number = block[min(text.count("\n", 0, start + skipped), len(block) - 1)][0]
            yield number, " ".join(piece.split())
        start = end.end()


def check_opening(tally, path, line, text, kind):
    """Checks the first sentence of a doc comment of an item of this kind."""
    word = re.match(r"\w+", text)
    word = word.group() if word and word.group()[0].isupper() else ""
    if word.lower() in CLAUSE_OPENERS:
        if not COMPLETE_OPENING.match(text) and not (kind in VALUES and VALUE_OPENING.match(text)):
            tally.add(path, line, "headless", text, CLAUSE_OPENERS[word.lower()])
        return
    for pattern, hint in WEAK_OPENERS:
        if re.match(pattern, text):
            tally.add(path, line, "opener", text, hint)
            return
    if kind == "fn" and NOUN_OPENER.match(text) and not text.endswith("?"):
        tally.add(path, line, "noun", text, "open with a verb: Returns, Creates, Computes")


def check_prose(tally, path, lines, kind=None):
    """Checks the sentences of a text; `kind` is the kind of the documented item, or None for other prose."""
    is_first = kind is not None
    tally.bases["doc comments"] += is_first
    tally.bases["function docs"] += kind == "fn"
    for block in paragraphs(lines):
        for line, text in sentences(block):
            if is_first:
                check_opening(tally, path, line, text, kind)
            check_sentence(tally, path, line, text, is_first)
            is_first = False


def check_sentence(tally, path, line, text, is_opening):
    """Checks a sentence of three or more words for its length, clauses and banned words."""
    words = len(re.findall(r"[\w‹›][\w‹›'’.,/×·%°+-]*", text))
    if words < 3:
        return
    tally.bases["sentences"] += 1
    if words > MAX_WORDS:
        tally.add(path, line, "long", text, f"{words} words; split it")
    if not re.search(r"\?[\"'”)*_]*$", text):
        for match in CLAUSE.finditer(text):
            # The rule headless covers a clause at the start of a doc comment.
            if not (is_opening and match.start() == 0) and not ASKING.search(text[:match.start()]):
                tally.add(path, line, "clause", text[max(0, match.start() - 30):], "use the noun that the clause means")
                break
    match = BANNED.search(text)
    if match:
        near = text[max(0, match.start() - 30):match.end() + 30]
        tally.add(path, line, "banned", f"[{match.group()}] {near}", BANNED_HINTS[int(match.lastgroup[1:])])


# Rust

TOKEN = re.compile(r"""(?P<comment>//[^\n]*|/\*.*?\*/)|(?P<string>\b(?:br|r)(?P<marks>\#*)".*?"(?P=marks)
                       |"(?:[^"\\]|\\.)*"|'(?:[^'\\\n]|\\(?:u\{[^}]*\}|x\w\w|.))')""", re.DOTALL | re.VERBOSE)
ATTRIBUTE = re.compile(r"\s*#!?\[(?:[^][]|\[(?:[^][]|\[[^][]*\])*\])*\]")
VISIBILITY = r"(?:pub(?:\([^)]*\))?\s+)?"
ITEM = re.compile(
    rf"\s*{VISIBILITY}(?:(?P<fn>(?:(?:default|const|async|unsafe|extern(?:\s+\"[^\"]*\")?)\s+)*fn)\b"
    r"|(?P<type>struct|enum|trait|type|union)\b|(?P<const>const|static)\b|(?P<other>mod|impl|use|macro_rules|unsafe)\b"
    r"|(?P<field>(?:r\#)?[a-z_]\w*\s*:(?!:))|(?P<variant>[A-Z]\w*))")
CLAP_TYPE = re.compile(
    r"^([ \t]*)#\[derive\([^)]*\b(?:Parser|Args|Subcommand|ValueEnum)\b.*?(?:^\1\}|\Z)", re.DOTALL | re.MULTILINE)
TEST = re.compile(r"#\[(?:\w+::)*\w*test\w*\b")
COMMENTED_CODE = re.compile(r".*[;{}]$|[\w.]+\(.*\)[?,;]?$|#\[|\w+::")
MESSAGE = re.compile(r"(?:(?P<error>#\[error\()|\b(?:(?:after_|before_)?(?:long_)?help|(?:long_)?about)\s*[=(])\s*$")


def check_rust(tally, path, source):
    """Checks the file name, names of types and tests, and the prose of a Rust file."""
    tally.bases["Rust files"] += 1
    stem = os.path.splitext(os.path.basename(path))[0]
    stem = os.path.basename(os.path.dirname(path)) if stem in ("mod", "lib", "main") else stem
    if re.sub(r"_tests?$", "", stem) in MODULE_NAMES and not re.search(r"(^|/)(tests|benches|examples)/", path):
        tally.add(path, 1, "module", stem, "name the data, the component or the decision with a noun")
    if re.search(r"@generated|automatically generated|DO NOT EDIT", source[:2000]):
        return
    tokens = list(TOKEN.finditer(source))
    # The code without the content of comments and strings, so that each item keeps its position.
    code = TOKEN.sub(lambda m: re.sub(r"[^\n]", " ", m.group()), source)
    breaks = [match.start() for match in re.finditer("\n", source)]

    def line_of(at):
        """Returns the number of the line that contains a position."""
        return bisect.bisect_left(breaks, at) + 1

    check_names(tally, path, code, line_of)
    clap = [match.span() for match in CLAP_TYPE.finditer(code)]
    block = []
    for token in tokens + [None]:
        text = token.group() if token else ""
        marker = re.match(r"(?://[/!]?(?![/!]))?", text).group()
        if marker and source[source.rfind("\n", 0, token.start()) + 1:token.start()].strip():
            continue  # A comment behind code.
        if block and (marker != block[0][0] or line_of(token.start()) != line_of(block[-1][1].start()) + 1):
            check_block(tally, path, source, code, clap, block, line_of)
            block = []
        if marker:
            block.append((marker, token))
        elif token and text[-1] in "\"#":
            message = MESSAGE.search(source, max(0, token.start() - 40), token.start())
            if message:
                check_message(tally, path, line_of(token.start()), text, message.group("error") is None)


def check_names(tally, path, code, line_of):
    """Checks the names of types and tests."""
    for match in re.finditer(rf"^[ \t]*{VISIBILITY}(?:struct|enum|trait|type)\s+(\w+)", code, re.MULTILINE):
        tally.bases["types"] += 1
        if match.group(1) in TYPE_NAMES:
            tally.add(path, line_of(match.start(1)), "type", match.group(1), "name the value with a noun")
    for match in TEST.finditer(code):
        item = item_at(code, match.start())
        name = re.match(r"\s+(\w+)", code[item.end():item.end() + 200]) if item and item.lastgroup == "fn" else None
        if name:
            tally.bases["tests"] += 1
            name, line = name.group(1), line_of(item.end())
            if TEST_WORDS.match(name):
                tally.add(path, line, "test", name, "subject_verb_object: rejects_foreign_scene")
            elif len(name) > MAX_TEST_NAME:
                tally.add(path, line, "test", name, f"{len(name)} characters; keep condition and outcome")


def check_block(tally, path, source, code, clap, block, line_of):
    """Checks a block of comment lines that begin with the same marker."""
    marker = block[0][0]
    lines = [(line_of(t.start()), re.sub("^ ", "", t.group()[len(marker):].rstrip())) for _, t in block]
    if lines[0][0] < 20 and re.search(r"Copyright|Licensed|SPDX", " ".join(text for _, text in lines)):
        return
    if marker == "//":
        check_prose(tally, path, [(n, text) for n, text in lines if not COMMENTED_CODE.match(text.strip())])
        return
    kind, end = "module", block[-1][1].end()
    if marker == "///":
        item = item_at(code, end)
        kind = item.lastgroup if item else "other"
        attributes = source[end:item.start()] if item else ""
        in_clap = kind in ("field", "variant") and any(start < end < stop for start, stop in clap)
        if in_clap or re.search(r"#\[\s*(?:arg|clap|command|value|group)\b", attributes):
            kind = "help"
        elif kind == "fn" and TEST.search(attributes):
            kind = "test"
    check_prose(tally, path, lines, kind)


def check_message(tally, path, line, literal, is_help):
    """Checks an error message or a help text, given as a string literal."""
    text = re.sub(r"\\\n\s*", "", re.sub(r'^b?r?#*"|"#*$', "", literal)).replace('\\"', '"')
    text = re.sub(r"\{[^{}]*\}", "‹value›", text)
    if re.search(r"[A-Za-z]{3} ", text):
        check_prose(tally, path, [(line, part) for part in text.split("\\n")], "help" if is_help else None)


def item_at(code, at):
    """Returns the match of the item after attributes and blanked comments, or None."""
    attribute = ATTRIBUTE.match(code, at)
    while attribute:
        at = attribute.end()
        attribute = ATTRIBUTE.match(code, at)
    return ITEM.match(code, at)


# Markdown


def prose_lines(text):
    """Returns (line number, text) for the lines outside fenced code, front matter and HTML comments."""
    text = re.sub(r"\A---\n.*?\n---\n", lambda m: "\n" * m.group().count("\n"), text, flags=re.DOTALL)
    text = re.sub(r"<!--.*?-->", lambda m: "\n" * m.group().count("\n"), text, flags=re.DOTALL)
    lines, fence = [], None
    for number, line in enumerate(text.split("\n"), 1):
        mark = re.match(r"\s*(?:[-*+>]\s+|\d+\.\s+)?(```+|~~~+)", line)
        if mark and (fence is None or line.strip().startswith(fence)):
            fence = mark.group(1) if fence is None else None
        elif fence is None:
            lines.append((number, line))
    return lines


def anchors(text):
    """Returns the anchors of a Markdown file as GitHub generates them, and explicit ids."""
    found, seen = set(), collections.Counter()
    for _, line in prose_lines(text):
        heading = re.match(r"\s{0,3}#{1,6}\s+(.*?)\s*#*\s*$", line)
        if heading:
            slug = re.sub(r"!?\[([^]]*)\]\([^)]*\)", r"\1", heading.group(1))
            slug = re.sub(r"<[^>]*>|[*`]|(?<!\w)_|_(?!\w)", "", slug).lower()
            slug = re.sub(r"[^\w\- ]", "", slug).replace(" ", "-")
            found.add(f"{slug}-{seen[slug]}" if seen[slug] else slug)
            seen[slug] += 1
        found.update(name.lower() for name in re.findall(r"\b(?:id|name)=[\"']([^\"']+)", line))
    return found


def link_fault(root, path, text, target):
    """Returns the reason why a link in the text of a file is dead, or None."""
    if re.match(r"[a-zA-Z][\w+.-]*:|//|[{<@/]", target):
        return None
    name, _, anchor = urllib.parse.unquote(target).partition("#")
    aim = os.path.normpath(os.path.join(root, os.path.dirname(path), name.partition("?")[0])) if name else path
    if name and not os.path.exists(aim):
        return "no such file"
    if anchor and aim.endswith(".md") and anchor.lower() not in anchors(read(aim) if name else text):
        return "the file has no such heading"
    return None


def check_markdown(tally, path, text, root):
    """Checks the prose, the width of lines, the links and the glossary terms of a Markdown file."""
    lines, terms = prose_lines(text), {}
    check_prose(tally, path, lines)
    for number, line in lines:
        is_table = line.lstrip().startswith("|")
        tally.bases["Markdown lines"] += bool(line.strip())
        # A line that consists of one link or one long word cannot be wrapped.
        can_wrap = " " in re.sub(r"\[[^]]*\]\([^)]*\)", "x", line).strip()
        if len(line) > MAX_COLUMNS and not is_table and can_wrap:
            tally.add(path, number, "wide", line, f"{len(line)} columns; wrap the line")
        bare = re.sub(r"(`+)(.+?)\1", "", line)
        for target in re.findall(r"\]\(\s*<?([^\s)>]+)|^\[[^]^][^]]*\]:\s*<?([^\s>]+)", bare):
            tally.bases["links"] += 1
            fault = link_fault(root, path, text, "".join(target))
            if fault:
                tally.add(path, number, "link", "".join(target), fault)
        if is_table and "glossary" in os.path.basename(path).lower():
            for term in line.strip().strip("|").split("|")[0].split(","):
                term = term.strip().strip("*`").lower()
                if term and term != "term" and not re.fullmatch(r"[:\s-]+", term):
                    tally.bases["terms"] += 1
                    if term in terms:
                        tally.add(path, number, "term", term, f"line {terms[term]} defines the term already")
                    terms.setdefault(term, number)


# Files and output


def check_files(root, paths):
    """Checks the given files, and the tracked Rust and Markdown files of the given folders."""
    listed = subprocess.run(["git", "-C", root, "ls-files", "-z", "--", *paths], stdout=subprocess.PIPE, check=True)
    names = set(listed.stdout.decode().split("\0")) | {p for p in paths if os.path.isfile(os.path.join(root, p))}
    tally = Tally()
    for name in sorted(map(os.path.normpath, names)):
        if name.endswith((".rs", ".md")) and os.path.isfile(os.path.join(root, name)):
            text = read(os.path.join(root, name))
            check_rust(tally, name, text) if name.endswith(".rs") else check_markdown(tally, name, text, root)
    return tally


def report(tally, with_findings):
    """Prints the findings and the table; returns true if no rule exceeds its limit."""
    if with_findings:
        for path, line, rule, text, hint in sorted(tally.findings, key=lambda finding: finding[:2]):
            print(f"{path}:{line}: {rule}: {text} -> {hint}")
    counts, passed = collections.Counter(finding[2] for finding in tally.findings), True
    print(f"{'rule':9} {'count':>6} {'share':>8} {'limit':>6}  of")
    for rule, (limit, is_share, base, _) in RULES.items():
        share = 100 * counts[rule] / max(tally.bases[base], 1)
        exceeds = (share if is_share else counts[rule]) > limit
        passed = passed and not exceeds
        print(f"{rule:9} {counts[rule]:6} {share:6.2f} % {limit:>4} {'%' if is_share else ' '}  "
              f"{tally.bases[base]} {base}{'  <- exceeded' if exceeds else ''}")
    return passed


# Rule -> name of the file, text with exactly one finding, and the corrected text.
EXAMPLES = {
    "headless": ("a.rs", "/// Whether a tile is done.\nfn f() {}", "/// Returns true if a tile is done.\nfn f() {}"),
    "opener": ("a.rs", "/// Its weight in tons.\nlet x: f32", "/// The weight of the cell in tons.\nlet x: f32"),
    "noun": ("a.rs", "#[inline]\n/// The number of cells.\npub const fn f() {}",
             "#[inline]\n/// Returns the number of cells.\npub const fn f() {}"),
    "clause": ("a.md", "The worker sends what it found.", "The worker sends the triangles.\nExplain what it does."),
    "banned": ("a.rs", '#[error("the coordinator refused {0}")]', '#[error("the coordinator rejected {0}")]'),
    "long": ("a.md", "One\n" * 41 + "end.", "One\n" * 20 + "end. " + "One\n" * 20 + "end."),
    "wide": ("a.md", "wide " * 24, "wide\n" * 24 + "| " + "wide " * 24 + " |"),
    "link": ("a.md", "See [no](no-such-page.md).", "See [here](#part) and [site](https://a.b/c.md).\n\n# Part"),
    "term": ("glossary.md", "| cell | box |\n| ray, cell | line |", "| cell | box |\n| ray | line |"),
    "module": ("src/keeping.rs", "fn f() {}", "/// `what` in \"who\" // ok"),
    "type": ("a.rs", "pub struct Whom;", "pub struct Recipient; // struct Whom"),
    "test": ("a.rs", "#[test]\n#[ignore]\nfn a_scene_loads() {}", "#[test]\nfn loads_scene() {}\nfn a_scene() {}"),
}


def self_test():
    """Checks each rule on a bad and a good example, and returns true if all agree."""
    faults = []
    for rule, (path, bad, good) in EXAMPLES.items():
        for text, expected in ((bad, [rule]), (good, [])):
            # A good module differs from a bad one in its name only.
            tally, name = Tally(), "src/retention.rs" if (rule, text) == ("module", good) else path
            check_rust(tally, name, text) if name.endswith(".rs") else check_markdown(tally, name, text, ".")
            found = [finding[2] for finding in tally.findings]
            if found != expected:
                faults.append(f"{rule}: expected {expected}, found {found} in {text!r}")
    if sorted(EXAMPLES) != sorted(RULES):
        faults.append("each rule needs an example")
    print("\n".join(faults) or f"prose: {len(EXAMPLES)} rules agree with their examples")
    return not faults


def main():
    """Runs the check and returns the exit code."""
    rules = "\n".join(f"  {rule:9} {meaning}" for rule, (_, _, _, meaning) in RULES.items())
    parser = argparse.ArgumentParser(description=__doc__, epilog="rules:\n" + rules,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("paths", nargs="*", help="files and folders, relative to the root of the repository")
    parser.add_argument("--summary", action="store_true", help="print only the table")
    parser.add_argument("--self-test", action="store_true", help="check the rules on examples")
    options = parser.parse_args()
    if options.self_test:
        return 0 if self_test() else 1
    root = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))
    for path in options.paths:
        if not os.path.exists(os.path.join(root, path)):
            parser.error(f"no such file or folder: {path}")
    return 0 if report(check_files(root, options.paths or ["."]), not options.summary) else 1


if __name__ == "__main__":
    sys.exit(main())
