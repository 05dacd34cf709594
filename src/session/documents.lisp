;;; anmech: documents of sections, sentences, formulas, scripts and pictures, as LaTeX and as HTML with MathML.
;;;
;;; A document is a list of parts [kind, content]: "section" and "text" with a text, "equations" with a display of
;;; LaTeX, "script" with a list of lines, "picture" with [file, words beneath it].
;;;
;;; Entry points: anmech_latex_document, anmech_html_document.

(in-package :anmech)
(needs "session/mathml" "session/scripts")

(defun part-kind (part) (second part))
(defun part-content (part) (third part))

(defun document-lines (parts writers)
  "The lines that WRITERS, a list kind, function .., makes of PARTS."
  (loop for part in (rest parts)
        append (let ((found (funcall (second (assoc (part-kind part) writers :test #'string=)) (part-content part))))
                 (if (listp found) found (list found)))))

(defun lines-of-document (lines)
  (cons '(maxima::mlist maxima::simp) (mapcar (lambda (line) (coerce line 'simple-string)) lines)))

;;; LaTeX

(defun latex-text (text)
  "TEXT with LaTeX's own signs marked."
  (with-output-to-string (out)
    (loop for char across text
          do (case char
               ((#\# #\$ #\% #\& #\_ #\{ #\}) (format out "\\~a" char))
               (#\\ (write-string "\\textbackslash{}" out))
               (#\~ (write-string "\\textasciitilde{}" out))
               (#\^ (write-string "\\textasciicircum{}" out))
               (#\< (write-string "\\textless{}" out))
               (#\> (write-string "\\textgreater{}" out))
               (#\" (write-string "''" out))
               (#\| (write-string "\\textbar{}" out))
               (t (write-char char out))))))

(maxima::defmfun maxima::$anmech_latex_document (title parts)
  "anmech_latex_document(title, [part, ...]): the lines of an article."
  (lines-of-document
   (append
    (list "\\documentclass[11pt,a4paper]{article}" "\\usepackage{amsmath}"
          "\\usepackage{graphicx}" "\\usepackage[margin=25mm]{geometry}" "\\allowdisplaybreaks"
          "\\setlength{\\parindent}{0pt}" "\\setlength{\\parskip}{1ex}"
          (format nil "\\title{~a}" (latex-text title)) "\\author{}" "\\date{}" "\\begin{document}" "\\maketitle")
    (document-lines
     parts
     (list (list "section" (lambda (text) (format nil "~%\\section{~a}" (latex-text text))))
           (list "text" (lambda (text) (list "" (latex-text text))))
           (list "equations" #'lines-in)
           (list "script" (lambda (lines) (append '("\\begin{small}" "\\begin{verbatim}") (rest lines)
                                                  '("\\end{verbatim}" "\\end{small}"))))
           (list "picture" (lambda (picture)
                             (list "\\begin{figure}[htbp]" "\\centering"
                                   (format nil "\\includegraphics[width=0.75\\textwidth]{~a}" (second picture))
                                   (format nil "\\caption{~a}" (latex-text (third picture))) "\\end{figure}")))))
    (list "\\end{document}"))))

;;; HTML

(maxima::defmfun maxima::$anmech_html_document (title parts)
  "anmech_html_document(title, [part, ...]): the lines of a page."
  (lines-of-document
   (append
    (list "<!DOCTYPE html>" "<html lang=\"en\">" "<head>" "<meta charset=\"utf-8\">"
          (format nil "<title>~a</title>" (html-text title))
          "<style>"
          "body { max-width: 48em; margin: 2em auto; padding: 0 1em; font-family: serif; line-height: 1.4; }"
          "math { margin: 0.6em 0; overflow-x: auto; }"
          "mtd { padding: 0.35em 0.1em; }"
          "pre { background: #f4f4f4; padding: 0.6em; overflow-x: auto; font-size: 0.85em; }"
          "figure { text-align: center; } figure img { max-width: 100%; } figcaption { font-style: italic; }"
          "</style>" "</head>" "<body>" (format nil "<h1>~a</h1>" (html-text title)))
    (document-lines
     parts
     (list (list "section" (lambda (text) (format nil "<h2>~a</h2>" (html-text text))))
           (list "text" (lambda (text) (format nil "<p>~a</p>" (html-text text))))
           (list "equations" #'mathml-display)
           (list "script" (lambda (lines) (append '("<pre>") (mapcar #'html-text (rest lines)) '("</pre>"))))
           (list "picture" (lambda (picture)
                             (format nil "<figure><img src=\"~a\" alt=\"~a\"><figcaption>~a</figcaption></figure>"
                                     (html-text (second picture)) (html-text (third picture))
                                     (html-text (third picture)))))))
    (list "</body>" "</html>"))))
