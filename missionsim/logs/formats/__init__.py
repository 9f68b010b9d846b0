"""One module a log format, each with `READERS`; `missionsim.logs.readers` finds them."""
