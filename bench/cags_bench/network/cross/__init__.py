"""Sessions beside other traffic on one bottleneck, in virtual time, with TCP modelled under each."""
