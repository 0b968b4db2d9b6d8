; PROMPT waits for a line of the keyboard, and here none is connected.
; stops: E4012 main 1
; after: n = undefined
.PROGRAM main()
  PROMPT "How many parts",n
.END
