"""Whether several recordings of one robot say the same: every number by recording, each foretold by others"""
