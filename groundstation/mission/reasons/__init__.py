"""Why things end as they do, in words for people; judges nothing and decides nothing."""
