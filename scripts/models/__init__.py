"""Parts of scripts/vendor_models.py: trials on given models, and the table of them."""
