"""Where the articles of WikiGame come from: the ones shipped here, a Kiwix server, or the API of a MediaWiki."""
