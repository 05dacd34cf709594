;;;; terms.lisp: the terms of the field in English, Chinese and Russian, for the manual.  After sections.lisp.
;;;;
;;;; terms.txt has a line for each: English | Chinese | the same in pinyin | Russian | the same in Latin letters.  The
;;;; manual is ASCII: Maxima finds its entries by the places of letters in the info file, and the Lisps do not agree on
;;;; how many letters a Chinese sign is; and TeX has no fonts for them.  So the info file and the PDF show what is in
;;;; Latin letters, and the HTML, where signs are written as numbers, all of it.
;;;;
;;;;   terms_are_listed()   whether share/anmech/terms.texi is the file that terms.txt makes
;;;;   terms_lacking()      lines that lack a language, or are not in order
;;;;   list_terms()         writes it

(in-package :anmech-tests)

(defun split-line (line)
  (loop with start = 0
        for bar = (search " | " line :start2 start)
        collect (subseq line start bar)
        while bar do (setq start (+ bar 3))))

(defun term-lines () (mapcar #'split-line (lines-of-file (concatenate 'string *root* "rtest/terms.txt"))))

(defun term-row (term)
  (destructuring-bind (english chinese pinyin russian latin) term
    (format nil "@item ~a~%@tab ~a@inlineraw{html, ~a}~%@tab ~a@inlineraw{html, ~a}" english
            pinyin (for-html (format nil "<br>~a" chinese)) latin (for-html (format nil "<br>~a" russian)))))

(defun terms-text ()
  (format nil "@c Written by make doc (rtest/terms.lisp).~%~
               @node Terms in three languages in anmech~%@appendix Terms in English, Chinese and Russian~%~
               @cindex Chinese terms~%@cindex Russian terms~%~%~
               In Latin letters; the manual in HTML has the signs, too.~%~%~
               @multitable @columnfractions .34 .28 .38~%@headitem English @tab Chinese @tab Russian~%~
               ~{~a~%~}@end multitable~%"
          (mapcar #'term-row (term-lines))))

(defun terms-file () (concatenate 'string *root* "share/anmech/terms.texi"))

(defun terms-are-listed () (string= (text-within (terms-file)) (terms-text)))

(defun list-terms ()
  (with-open-file (stream (terms-file) :direction :output :if-exists :supersede)
    (write-string (terms-text) stream)))

(defun terms-lacking ()
  (flet ((within (bytes from to) (some (lambda (point) (<= from point to)) (code-points bytes))))
    (loop for (term next) on (term-lines)
          unless (and (= (length term) 5) (within (second term) #x4E00 #x9FFF) (within (fourth term) #x410 #x44F)
                      (every (lambda (letter) (< (char-code letter) 128)) (third term))
                      (every (lambda (letter) (< (char-code letter) 128)) (fifth term))
                      (or (null next) (string-lessp (first term) (first next))))
            collect (first term))))

(in-package :maxima)

(defmfun $terms_are_listed () (anmech-tests::terms-are-listed))
(defmfun $terms_lacking () (anmech-tests::maxima-list-with (anmech-tests::terms-lacking)))
(defmfun $list_terms () (anmech-tests::list-terms) '$done)
