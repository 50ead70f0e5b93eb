"""`robrain bench`: measurements that anybody can repeat."""
