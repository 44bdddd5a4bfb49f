"""A model beside a case: the joint fit, where it fails, which physics is missing, and what to measure next."""
