"""People in a browser: sessions and their cookies, forms, pages, and logging in."""
