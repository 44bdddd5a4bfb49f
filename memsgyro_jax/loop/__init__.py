"""One die in operation, sample by sample: read-out, observer, controller, filter, scenario, engine, trace and bound."""
