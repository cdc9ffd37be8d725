"""Why a solve failed, where in the body, and what to try."""
