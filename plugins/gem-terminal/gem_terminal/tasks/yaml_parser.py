"""What splits YAML: libyaml, or Python where PyYAML was built without it."""

from __future__ import annotations

try:
    from yaml._yaml import CParser as YamlParser
except ImportError:
    from yaml.parser import Parser
    from yaml.reader import Reader
    from yaml.scanner import Scanner

    class YamlParser(Reader, Scanner, Parser):  # type: ignore[no-redef]  # one of the two is there
        """Does in Python what libyaml does."""

        def __init__(self, stream: str) -> None:
            Reader.__init__(self, stream)
            Scanner.__init__(self)
            Parser.__init__(self)


__all__ = ["YamlParser"]
