"""Published experiments, run again with amulor's public interface."""
