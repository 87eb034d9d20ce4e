"""The paper, claim by claim: each module of this package makes one section of the report."""
