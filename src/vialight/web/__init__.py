"""The operator's page: shows a print in a browser while it runs and after, and asks for a stop.

Importing this is cheap: the server's parts are imported when it is started.
"""

from vialight.web.server import PageProcess, PageSettings, network_warning, serve

__all__ = ["PageProcess", "PageSettings", "network_warning", "serve"]
