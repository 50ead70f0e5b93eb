"""The process of one robot, and the files that it reads and writes."""
