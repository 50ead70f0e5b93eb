"""`robrain up`: the processes of a team or of one machine, started, watched and started again; `robrain top`."""
