"""The plugins that come with robrain, by level, one folder each."""
