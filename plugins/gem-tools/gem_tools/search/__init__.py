"""The tool ``search``: BM25 over a local corpus, retrieval servers, and web search engines."""
