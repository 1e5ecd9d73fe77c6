"""Report of a trial: ``results.json``, JUnit XML, and an HTML page."""
