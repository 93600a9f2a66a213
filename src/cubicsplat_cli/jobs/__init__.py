"""From picture files to result files: plan jobs, skip finished ones, and run the rest."""
