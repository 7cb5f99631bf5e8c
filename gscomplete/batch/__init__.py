"""Many objects, one after another and side by side: plan, workers, ledger, stores."""
