"""One trial before and after it runs: its plan, its endings, what is judged and what it leaves."""
