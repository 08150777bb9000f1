"""The live page: campaigns in a browser while they run, and afterwards. It reads databases and writes none."""
