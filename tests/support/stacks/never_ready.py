"""A stack that never asks for a goal; it ignores SIGINT and SIGTERM, too."""

import signal
import time

for number in (signal.SIGINT, signal.SIGTERM):
    signal.signal(number, signal.SIG_IGN)
while True:
    time.sleep(1.0)
