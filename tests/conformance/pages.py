"""A report's page as a test reads it: ids, sources, texts and tables; it checks that each element is closed."""

from html.parser import HTMLParser


class ParsedPage(HTMLParser):
    VOID = ("meta", "img", "br")

    def __init__(self, page: str) -> None:
        super().__init__()
        self.ids: list[str] = []
        self.sources: list[str] = []
        self.text = ""
        self.numbers = ""
        self.scripts = 0
        self.tables: list[list[list[str]]] = []
        self._open: list[str] = []
        self.feed(page)
        assert not self._open

    @property
    def flat_text(self) -> str:
        return " ".join(self.text.split())

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        values = dict(attrs)
        self.ids += [v] if (v := values.get("id")) else []
        self.sources += [v for name in ("src", "href") if (v := values.get(name))]
        self.scripts += tag == "script"
        if tag == "table":
            self.tables.append([])
        elif tag == "tr":
            self.tables[-1].append([])
        elif tag in ("td", "th"):
            self.tables[-1][-1].append("")
        if tag not in self.VOID:
            self._open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self._open.pop() == tag

    def handle_data(self, data: str) -> None:
        if self._open[-1:] in (["td"], ["th"]):
            self.tables[-1][-1][-1] += data
        if self._open[-1:] == ["script"]:
            self.numbers += data
        elif self._open[-1:] != ["style"]:
            self.text += data
