"""What a trial reports: ``results.json``, JUnit XML, and one HTML page. Pure but for the files that it reads and writes."""
