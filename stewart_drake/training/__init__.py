"""Training of the paper's network, the only place that imports torch, and of the policy, and the verdict."""
