"""The games of the library ``textarena``; nothing is imported here, so that listing their ids stays cheap."""
