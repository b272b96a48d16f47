"""The virtual turbine and its measurement campaigns, independent of the model that is updated."""
