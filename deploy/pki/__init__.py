"""`robrain pki` and `robrain router`: the team's certificates, and a router that heeds them."""
