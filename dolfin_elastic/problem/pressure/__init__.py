"""The pressure beside the displacement: one continuous field a material."""
