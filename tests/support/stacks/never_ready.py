"""A stack that never becomes ready for a goal, and ignores SIGINT and SIGTERM."""

import signal
import time

for number in (signal.SIGINT, signal.SIGTERM):
    signal.signal(number, signal.SIG_IGN)
while True:
    time.sleep(1.0)
